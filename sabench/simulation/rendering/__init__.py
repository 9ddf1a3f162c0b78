"""From a world and its optics to the pictures that a camera array records."""
