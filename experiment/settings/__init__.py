"""experiment/settings"""
