"""experiment/study"""
