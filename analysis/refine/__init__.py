"""What follows the network's steps: the exact value, and how sure it is."""
