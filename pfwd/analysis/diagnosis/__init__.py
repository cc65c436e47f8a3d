"""The diagnosis of files and surveys: points gathered, diagnosed, written down, drawn."""
