"""Charts and images as PNG files."""
