"""Terminal screen of a measuring session and of a recorded survey.

The screen adds no science and never delays the session, which runs in a thread of its own. Its
events wait in a mailbox; samples arrive reduced to the range in each interval.
"""
