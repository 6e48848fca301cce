//! Networks: one message, one session, and one file or folder per transport.
