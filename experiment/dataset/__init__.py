"""experiment/dataset"""
