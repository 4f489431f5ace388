"""What theory predicts: bounds, phase noise, bias by clipping."""
