"""How good a reconstruction is: masks, pose and contact. It cannot see the energy that was minimised."""
