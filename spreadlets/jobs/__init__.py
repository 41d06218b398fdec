"""Jobs: images to make from files, described so that any process can make them; and sequences of them."""
