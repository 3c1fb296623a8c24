"""Runnable examples, each about a page: start them from the checkout."""
