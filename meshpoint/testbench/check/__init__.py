"""Whether a bus and what is on it are ready for the controller: `meshpoint check`."""
