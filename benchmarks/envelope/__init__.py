"""Every kind of shift, sheet and sensor in one table: a campaign of campaigns."""
