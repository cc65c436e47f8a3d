"""The live screen: what a measuring session does, shown and steered from a terminal.

It adds no science and never holds up the session, which runs in a thread of its own: events wait in
a mailbox, samples are reduced to their least and largest values before they come here.
"""
