"""A simulated participant who feels what is presented."""
