"""analysis/audit"""
