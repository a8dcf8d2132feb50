"""experiment/rehearsal/wires"""
