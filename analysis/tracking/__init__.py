"""From pictures to where the ball is in them: found by how it moves, then by how it looks.

`track` is the whole of it: against a `background` there are `candidates`, among them the longest
free flight (`arcs`); the `appearance` of what flew is then learnt by fits of a `drawn_ball`, and
`following` finds it again in all pictures and picks one candidate of each. `pictures` reads them;
`thumbnails` and `ball_picker` let a user show the ball.
"""
