"""Differentiable statics: what physics alone says about a contact, as torch layers."""
