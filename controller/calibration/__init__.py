"""What has been learned, as records and as a file."""
