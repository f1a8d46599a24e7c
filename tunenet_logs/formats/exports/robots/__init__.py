"""Tables recorded by robot controllers."""
