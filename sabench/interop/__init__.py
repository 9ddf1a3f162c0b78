"""Cameras, images and settings as other programs read them, and their results back; what runs such a program in a process of its own."""
