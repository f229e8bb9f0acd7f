"""`meshpoint simulate --silkit`: controller and rig as coordinated participants of SIL Kit."""
