"""Design of flights that tell most."""
