"""One participant doing one task: everything opened, trial after trial, and each thing on disk before the next.

A protocol, a rig and a participant come in; a journal and the raw frames of the tracker go out. What every kind of
trial shares stands here, each kind in a folder of its own behind the seam in `kind.py`; no kind imports another. A
session opens devices by `apparatus` alone and shows itself by the desk's port. It knows nothing of rehearsals: what
stands at the far ends of its ports is an argument.
"""
