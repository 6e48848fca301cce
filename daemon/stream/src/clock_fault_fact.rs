//! Facts of a run about the hosts whose clocks have injected faults.

/// Name of the fact about the edge, and beginning of the name of a fact about a cloud.
const NAME: &str = "Clock fault";
/// Name of the fact in runs of releases before 0.3.0. Databases still contain such runs.
const FORMER_NAME: &str = "Rehearsal";

/// Host of a run whose clock has injected faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultyHost<'a> {
    /// The edge.
    Edge,
    /// The cloud with this name.
    Cloud(&'a str),
}

impl<'a> FaultyHost<'a> {
    /// Returns the host that the fact with this name describes; `None` if the name is of another fact.
    #[must_use]
    pub fn from_fact_name(name: &'a str) -> Option<Self> {
        match name.strip_prefix(NAME).or_else(|| name.strip_prefix(FORMER_NAME))? {
            "" => Some(Self::Edge),
            rest => rest.strip_prefix(" of ").map(Self::Cloud),
        }
    }

    /// Returns the name of the fact about this host.
    #[must_use]
    pub fn fact_name(self) -> String {
        match self {
            Self::Edge => NAME.to_owned(),
            Self::Cloud(name) => format!("{NAME} of {name}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_is_found_in_current_and_former_fact_names() {
        for host in [FaultyHost::Edge, FaultyHost::Cloud("gpu-1")] {
            assert_eq!(FaultyHost::from_fact_name(&host.fact_name()), Some(host));
        }
        assert_eq!(FaultyHost::from_fact_name("Rehearsal"), Some(FaultyHost::Edge));
        assert_eq!(FaultyHost::from_fact_name("Rehearsal of gpu-1"), Some(FaultyHost::Cloud("gpu-1")));
        for name in ["Rehearsals", "Clock faults", "Clock", "Sensor", ""] {
            assert_eq!(FaultyHost::from_fact_name(name), None, "{name}");
        }
    }
}
