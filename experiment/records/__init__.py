"""experiment/records"""
