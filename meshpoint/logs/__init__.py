"""What a bus carries, recorded or as it goes on: logs, captures, `meshpoint watch` and `tell`."""
