"""What all rooms of the bench share: errors, exit codes, version and provenance."""
