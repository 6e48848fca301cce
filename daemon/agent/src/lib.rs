//! peernet-agent
