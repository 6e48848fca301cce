//! What one who is not known may take before anybody asked who that is.

mod probes;
