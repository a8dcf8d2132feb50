"""experiment/apparatus/tracker"""
