"""Statistics of frames and curves: binned sums with their covariance, frame random effects, formulas."""
