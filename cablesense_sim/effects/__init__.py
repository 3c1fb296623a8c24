"""What a real arm does beyond the ideal one: one effect a file, found by `registry`.

An effect declares its name, places, parameters, order and text, and what it does. The static
replay, the running sim node, the randomisation in training and the diagnosis all work from that
one file. To add an effect, add a file here, or offer the class under the entry point group
`cablesense.effects` of another package.
"""
