"""Image files, preprocessing, brightness and peaks of camera images."""
