//! Builds libzmq with its draft sockets, of which RADIO and DISH are two.

fn main() {
    zeromq_src::Build::new().enable_draft(true).build();
}
