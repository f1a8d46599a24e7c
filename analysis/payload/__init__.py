"""Payload identification: an arm's payload mass and centre of mass from joint torques."""
