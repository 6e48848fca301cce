//! The value of `[serve] listen`: an address or a list of addresses.

use std::fmt;
use std::num::NonZeroUsize;

use peernet_networks::Address;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Maximum number of addresses. Each has its own connections, sessions and memory.
const MAX_ADDRESSES: usize = 16;

/// Addresses to listen on: at least one, without duplicates. A single address is serialised without brackets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenAddresses(Vec<Address>);

/// Reason why a list of addresses is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ListenAddressesError {
    /// The list has no address.
    #[error("the list is empty; name at least one address, or remove [serve]")]
    Empty,
    /// The list has more than 16 addresses.
    #[error("{0} addresses are too many; at most {MAX_ADDRESSES}")]
    TooMany(usize),
    /// An address occurs twice. An address with port 0 may occur twice, because it stands for a different free port
    /// each time.
    #[error("the list contains {0} twice; remove one of the two")]
    Twice(Address),
}

impl ListenAddresses {
    /// Creates a list of addresses.
    ///
    /// # Errors
    /// When the list is empty or too long, or has duplicates.
    pub fn new(addresses: Vec<Address>) -> Result<Self, ListenAddressesError> {
        if addresses.is_empty() {
            return Err(ListenAddressesError::Empty);
        }
        if addresses.len() > MAX_ADDRESSES {
            return Err(ListenAddressesError::TooMany(addresses.len()));
        }
        // The system chooses a free port for each address with port 0. For an address in a ROS 2 domain `port()` is 0,
        // too, but no port is chosen.
        let is_duplicate = |index: &usize| {
            (addresses[*index].port() != 0 || addresses[*index].ros_domain().is_some())
                && addresses[..*index].contains(&addresses[*index])
        };
        if let Some(index) = (1..addresses.len()).find(is_duplicate) {
            return Err(ListenAddressesError::Twice(addresses[index].clone()));
        }
        Ok(Self(addresses))
    }

    /// Returns all addresses, in the order of the configuration.
    pub fn as_slice(&self) -> &[Address] {
        &self.0
    }

    /// Returns the number of addresses.
    pub fn count(&self) -> NonZeroUsize {
        NonZeroUsize::new(self.0.len()).expect("all constructors refuse an empty list")
    }
}

impl From<Address> for ListenAddresses {
    fn from(address: Address) -> Self {
        Self(vec![address])
    }
}

impl Serialize for ListenAddresses {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0.as_slice() {
            [address] => address.serialize(serializer),
            addresses => addresses.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for ListenAddresses {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ListenAddressesVisitor)
    }
}

/// Visitor that reads an address or a list.
// An untagged enum would be shorter, but its error would not say what is wrong with an address.
struct ListenAddressesVisitor;

impl<'de> Visitor<'de> for ListenAddressesVisitor {
    type Value = ListenAddresses;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an address or a list of addresses")
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<ListenAddresses, E> {
        text.parse::<Address>().map(ListenAddresses::from).map_err(E::custom)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<ListenAddresses, A::Error> {
        let mut addresses = Vec::new();
        while let Some(address) = list.next_element()? {
            addresses.push(address);
        }
        ListenAddresses::new(addresses).map_err(A::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, from_value, json, to_value};

    use super::*;

    #[test]
    fn one_address_and_lists_read_back_as_written() {
        for (written, count) in [
            (json!("tcp://127.0.0.1:5551"), 1),
            (json!(["tcp://127.0.0.1:5551", "tcp://[::1]:5551"]), 2),
            (json!(["tcp://127.0.0.1:0", "tcp://127.0.0.1:0"]), 2),
        ] {
            let read: ListenAddresses = from_value(written.clone()).expect("addresses");
            assert_eq!((read.count().get(), to_value(&read).expect("writes")), (count, written));
        }
        let single_address: ListenAddresses = from_value(json!(["tcp://a:1"])).expect("an address");
        assert_eq!(to_value(&single_address).expect("writes"), json!("tcp://a:1"));
    }

    #[test]
    fn invalid_lists_are_refused_with_reason() {
        let too_many: Vec<String> = (1..=17).map(|port| format!("tcp://a:{port}")).collect();
        let invalid: [(Value, &str); 5] = [
            (json!([]), "the list is empty"),
            (json!(["tcp://a:1", "tcp://b:1", "tcp://a:1"]), "the list contains tcp://a:1 twice"),
            (json!(too_many), "17 addresses are too many; at most 16"),
            (json!(["tcp://a:1", "a:1"]), "\"a:1\" is not an address: the scheme is missing"),
            (json!(5551), "expected an address or a list of addresses"),
        ];
        for (value, expected) in invalid {
            let error = from_value::<ListenAddresses>(value).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
