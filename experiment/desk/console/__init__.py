"""The experimenter's console: a full screen in a terminal or a browser, and a process of its own.

A session's newest view comes in over its link and is drawn; keys and clicks go out as commands. The console decides
nothing and keeps nothing: it may be closed, or die, at any moment, and another one that is opened goes on from the next
view. What is drawn, which press of a key counts, and what a form asks for are pure modules of their own; `app.py`
alone, with its widgets, knows Textual.
"""

import os

# Whatever is drawn waits for its next turn; Textual, which reads this when it is loaded, would have 60 a second.
os.environ.setdefault("TEXTUAL_FPS", "120")
