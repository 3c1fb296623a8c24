"""Estimators put to the test on fresh contacts, as section IV-B and IV-C do."""
