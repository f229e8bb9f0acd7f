"""The preset `thesis`: equations 4.1 to 4.17 in closed form."""
