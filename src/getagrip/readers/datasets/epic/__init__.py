"""EPIC-KITCHENS, EPIC-Grasps and VISOR."""
