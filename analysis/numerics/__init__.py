"""analysis/numerics"""
