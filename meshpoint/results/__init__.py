"""What a run gives: a row for each shift, traces, figures. `report` draws them."""
