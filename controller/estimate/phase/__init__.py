"""The angle between gear teeth and sleeve teeth: learned, lost, recovered."""
