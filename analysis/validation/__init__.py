"""analysis/validation"""
