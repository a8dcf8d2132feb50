"""analysis/reading"""
