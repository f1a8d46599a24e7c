"""Tune real balls: air, a restitution that falls with speed; does the tuned one move alike?"""
