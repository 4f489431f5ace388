"""The gate for a decoder: its cases, its decoders, its verdict."""
