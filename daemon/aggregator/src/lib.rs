//! peernet-aggregator
