"""Where episodes come from: simulators today, sensors next to them."""
