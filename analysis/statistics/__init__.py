"""analysis/statistics"""
