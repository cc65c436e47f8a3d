"""One module a sub-command; each imports what is heavy when it is run, not before."""
