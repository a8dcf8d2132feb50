"""analysis/documents"""
