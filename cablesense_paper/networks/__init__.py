"""Networks of many shapes, trained and tested alike, as section III-C explores them."""
