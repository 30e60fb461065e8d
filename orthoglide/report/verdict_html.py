def verdict_page(*a): return "stub"
