"""What a microphone heard, as moments: the onsets of knocks."""
