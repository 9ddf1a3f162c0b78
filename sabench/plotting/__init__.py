"""Charts and pictures as PNG files."""
