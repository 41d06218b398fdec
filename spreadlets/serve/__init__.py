"""A warm process for hosts: it makes images for programs that cannot, or need not, load the package themselves."""
