"""The angle between gear teeth and sleeve teeth: learned, kept, lost, found again."""
