"""experiment/apparatus/doctor"""
