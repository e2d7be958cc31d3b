"""Marks and labels of people, with their history, and the files made from them."""
