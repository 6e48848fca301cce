//! Names of nodes and topics.

use std::sync::Arc;

use thiserror::Error;

/// Longest accepted name, bytes.
const MAX_NAME_BYTES: usize = 1024;

/// Error: the name is not allowed in ROS 1.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    /// The name is empty.
    #[error("a ROS name is empty")]
    Empty,
    /// The name is too long.
    #[error("a ROS name, with its namespace, has {length} bytes; the limit is {MAX_NAME_BYTES}")]
    TooLong {
        /// Length of the name with its namespace, bytes.
        length: usize,
    },
    /// The name, or its part after `~`, begins with something other than a letter or `/`.
    #[error("the ROS name {name:?} must begin with a letter, after / or ~ if it has one")]
    Start {
        /// The name.
        name: String,
    },
    /// The name has a character that is not allowed.
    #[error("the ROS name {name:?} contains {character:?}; letters, digits, _ and / are allowed")]
    Character {
        /// The name.
        name: String,
        /// The first such character.
        character: char,
    },
    /// The node's name contains a namespace.
    #[error("the node name {name:?} contains a namespace; set the namespace by ROS_NAMESPACE instead")]
    NodeWithNamespace {
        /// The name.
        name: String,
    },
}

/// Name of a node, by which relative and private names are resolved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// Global name of the namespace. It begins with `/`, and only the root `/` also ends with `/`.
    namespace: String,
    global: Arc<str>,
}

impl NodeName {
    /// Creates the name of a node in a namespace, whose first `/` may be omitted.
    ///
    /// # Errors
    /// If a name is not allowed in ROS, or the node's name contains a namespace.
    pub fn new(namespace: &str, name: &str) -> Result<Self, NameError> {
        let root = "/".to_owned();
        let namespace = if namespace.trim_matches('/').is_empty() { root } else { join("/", namespace)? };
        if name.contains(['/', '~']) {
            return Err(NameError::NodeWithNamespace { name: name.to_owned() });
        }
        let global = join(&namespace, name)?.into();
        Ok(Self { namespace, global })
    }

    /// Returns the node's global name, such as `/robot/camera`.
    pub fn global(&self) -> &str {
        &self.global
    }

    /// Returns a shared copy of the node's global name.
    pub(super) fn to_arc(&self) -> Arc<str> {
        Arc::clone(&self.global)
    }

    /// Returns the global name of a topic: `/a` is global already, `a` is in the namespace, `~a` is below the node.
    ///
    /// # Errors
    /// If the name is not allowed in ROS.
    pub fn resolve(&self, name: &str) -> Result<String, NameError> {
        match name.strip_prefix('~') {
            Some(private) => join(&self.global, private.trim_start_matches('/')),
            None if name.starts_with('/') => join("/", name),
            None => join(&self.namespace, name),
        }
    }
}

/// Checks a name and appends it to a namespace, with one `/` between any two parts.
fn join(namespace: &str, name: &str) -> Result<String, NameError> {
    if name.trim_matches('/').is_empty() {
        return Err(NameError::Empty);
    }
    let length = namespace.len() + 1 + name.len();
    if length > MAX_NAME_BYTES {
        return Err(NameError::TooLong { length });
    }
    let name_text = || name.to_owned();
    if !name.starts_with(|first: char| first.is_ascii_alphabetic() || first == '/') {
        return Err(NameError::Start { name: name_text() });
    }
    let is_allowed = |character: char| character.is_ascii_alphanumeric() || "_/".contains(character);
    if let Some(character) = name.chars().find(|character| !is_allowed(*character)) {
        return Err(NameError::Character { name: name_text(), character });
    }
    let parts = namespace.split('/').chain(name.split('/')).filter(|part| !part.is_empty());
    Ok(parts.fold(String::new(), |name, part| name + "/" + part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_resolve_by_their_first_character() {
        let node = NodeName::new("robot", "camera").unwrap();
        assert_eq!(node.global(), "/robot/camera");
        for (name, expected) in [
            ("image", "/robot/image"),
            ("a/b", "/robot/a/b"),
            ("/image", "/image"),
            ("//a//b/", "/a/b"),
            ("~image", "/robot/camera/image"),
            ("~/image", "/robot/camera/image"),
        ] {
            assert_eq!(node.resolve(name).unwrap(), expected, "{name}");
        }
    }

    #[test]
    fn root_namespace_has_several_spellings() {
        for namespace in ["", "/", "//"] {
            assert_eq!(NodeName::new(namespace, "n").unwrap().resolve("t").unwrap(), "/t");
        }
        assert_eq!(NodeName::new("/a/b/", "n").unwrap().global(), "/a/b/n");
    }

    #[test]
    fn invalid_names_are_refused() {
        let node = NodeName::new("/", "n").unwrap();
        assert_eq!(node.resolve(""), Err(NameError::Empty));
        assert_eq!(node.resolve("/"), Err(NameError::Empty));
        assert_eq!(node.resolve("~"), Err(NameError::Empty));
        assert_eq!(node.resolve("1a"), Err(NameError::Start { name: "1a".into() }));
        let expected = NameError::Character { name: "a-b".into(), character: '-' };
        assert_eq!(node.resolve("a-b"), Err(expected));
        assert!(matches!(node.resolve(&"a".repeat(2000)), Err(NameError::TooLong { .. })));
        let expected = NameError::NodeWithNamespace { name: "a/b".into() };
        assert_eq!(NodeName::new("/", "a/b"), Err(expected));
    }
}
