"""experiment/cli"""
