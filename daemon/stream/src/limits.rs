//! Limits of a live update.

/// Largest number of links of a live update.
pub const MAX_LINKS: usize = 1024;

/// Largest number of kinds of network of a link.
pub const MAX_NETWORKS: usize = 64;

/// Largest number of pipelines of a host, which may all use one link.
pub const MAX_PIPELINES: usize = 256;
