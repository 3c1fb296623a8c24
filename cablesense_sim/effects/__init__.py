"""How a real arm differs from the ideal one: effects, in modules by their place of action.

An effect is one class: it declares its name, places, parameters, order and text, and how it acts.
The static replay, the sim node, the randomisation in training and the diagnosis all use that
class. To add an effect, add it to one of the modules here, or offer the class in another package
under the entry point group `cablesense.effects`.
"""
