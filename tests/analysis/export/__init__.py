"""What tunenet-export writes."""
