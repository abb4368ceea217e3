/* Stand-in, which is not compiled: it tells that this firmware takes the force of each motor, normalizedForces. */
