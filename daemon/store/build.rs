//! Makes cargo rebuild the crate when a migration is added, because migrations are compiled into the crate.

fn main() {
    println!("cargo:rerun-if-changed=../../migrations");
}
