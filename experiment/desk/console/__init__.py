"""The experimenter's console: a full screen in a terminal or a browser, and a process of its own.

It draws the session's newest view and sends commands, so it may end at any moment and be opened again. Views, key
presses and forms are pure modules; `app.py` alone knows Textual.
"""

import os

# Whatever is drawn waits for its next turn; Textual, which reads this when it is loaded, would have 60 a second.
os.environ.setdefault("TEXTUAL_FPS", "120")
