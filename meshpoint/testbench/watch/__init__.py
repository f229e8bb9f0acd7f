"""What happens on a bus, for people to follow: line by line, or drawn as it goes on.

Fed with the frames of a log or of a live bus in their order; nothing here sends a frame.
"""
