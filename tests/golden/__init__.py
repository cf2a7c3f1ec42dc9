"""Golden flights: a few numbers of each, by which a change of behaviour is found."""
