"""Is a decoder worse than its baseline? Statistics of repeated captures."""
