"""How good a reconstruction is: masks, pose and contact. Nothing here knows the energy that was minimised."""
