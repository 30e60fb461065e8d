def draw_verdict(view): return []
