//! Facts of a run about the hosts whose clocks have injected faults.

/// Name of the fact about the edge. The name of the fact about a cloud begins with it.
const NAME: &str = "Clock fault";
/// Name of the fact in versions before 0.3.0, whose runs are still stored.
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
    /// Returns the host that a fact with this name is about; `None` if the fact is not about a clock fault.
    #[must_use]
    pub fn of_fact(name: &'a str) -> Option<Self> {
        match name.strip_prefix(NAME).or_else(|| name.strip_prefix(FORMER_NAME))? {
            "" => Some(Self::Edge),
            rest => rest.strip_prefix(" of ").map(Self::Cloud),
        }
    }

    /// Returns the name of the fact about this host.
    #[must_use]
    pub fn fact(self) -> String {
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
    fn facts_of_this_and_former_versions_name_the_host() {
        for host in [FaultyHost::Edge, FaultyHost::Cloud("gpu-1")] {
            assert_eq!(FaultyHost::of_fact(&host.fact()), Some(host));
        }
        assert_eq!(FaultyHost::of_fact("Rehearsal"), Some(FaultyHost::Edge));
        assert_eq!(FaultyHost::of_fact("Rehearsal of gpu-1"), Some(FaultyHost::Cloud("gpu-1")));
        for name in ["Rehearsals", "Clock faults", "Clock", "Sensor", ""] {
            assert_eq!(FaultyHost::of_fact(name), None, "{name}");
        }
    }
}
