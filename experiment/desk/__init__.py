"""experiment/desk"""
