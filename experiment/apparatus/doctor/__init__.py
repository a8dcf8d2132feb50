"""Whether a rig is in order, asked before anybody is on the panel.

A rig file and a protocol come in; checks go out, each green, red with the remedy, or not checked with the reason. The
checks use the drivers of sessions, at the priority of sessions. The far ends of a simulated rig are handed in: this
room knows no rehearsal.
"""
