"""`meshpoint play`: a page on which a person fires the sleeve."""
