"""`meshpoint convert`: a log as time series, for the viewers that people have."""
