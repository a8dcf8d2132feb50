"""Whether a rig is in order, by the drivers and at the priority of sessions, before anybody is on the panel."""
