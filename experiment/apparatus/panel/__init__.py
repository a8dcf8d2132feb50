"""experiment/apparatus/panel"""
