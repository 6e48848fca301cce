//! peernet-imaging
