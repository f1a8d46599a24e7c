"""Ball tracking in pictures: found by how it moves, then by how it looks.

`track` is the whole of it. `frames` are decoded once and kept. Against a background there are
`candidates`; the longest free flight among them is the ball's (`flights`). The `appearance` of what
flew is learnt, the ball is found by it in all pictures, and followed from its flight to both ends.
With the `picker` a user marks the ball.
"""
