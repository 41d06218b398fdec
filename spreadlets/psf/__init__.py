"""Point spread functions: their models' parameter spaces, nested grids, spreadlets, and databases of them."""
