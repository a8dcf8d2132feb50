"""analysis/power"""
