"""Tune balls that one engine drops in another: does a tuning mean the same everywhere?"""
