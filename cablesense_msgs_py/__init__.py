"""The contract of CableSense: topics, frames, message conversions and the error family."""
