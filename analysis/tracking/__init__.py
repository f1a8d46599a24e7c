"""Ball tracking in pictures: found by how it moves, then by how it looks.

`track` is the whole of it. `pictures` are decoded once, and `kept_film` keeps them. Against a
`background` there are `candidates`; some of them lie on parabolas (`triples`), and the longest free
flight is the ball's (`arcs`). The `appearance` of what flew is learnt by fits of a `drawn_ball`;
`ball_detector` finds it again in all pictures, and `following` picks one candidate of each.
`thumbnails` and `ball_picker` let a user show the ball.
"""
