"""The experimenter's desk: what a session or a recording shows, and the keys that it takes.

`port` says what a console must do, and `terminal` does it in lines of text. A desk never decides what comes next.
"""
