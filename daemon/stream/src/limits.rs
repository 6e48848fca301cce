//! Limits of a live update.

/// Maximum number of links of a live update.
pub const MAX_LINKS: usize = 1024;

/// Maximum number of kinds of network of a link.
pub const MAX_NETWORKS: usize = 64;

/// Maximum number of pipelines of a host, which may all use one link.
pub const MAX_PIPELINES: usize = 256;
