"""Planning of experiments: figures of a scene before anything is built."""
