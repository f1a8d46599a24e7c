"""Balls that one engine drops, tuned in another: does a tuning mean the same everywhere?"""
