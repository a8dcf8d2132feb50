"""What becomes of a dataset outside of the laboratory: accidents in other systems, signed anchors, shared copies."""
