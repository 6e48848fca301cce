//! Binding to the part of libzmq's interface that RADIO and DISH need (`zmq.h`, with drafts).

use std::ffi::{CStr, CString, c_char, c_int, c_void};

use anyhow::{Result, bail};

const RADIO: c_int = 14;
const DISH: c_int = 15;
const LINGER: c_int = 17;
const SNDHWM: c_int = 23;
const RCVHWM: c_int = 24;

/// `zmq_msg_t`.
#[repr(C, align(8))]
struct Message([u8; 64]);

unsafe extern "C" {
    fn zmq_ctx_new() -> *mut c_void;
    fn zmq_socket(context: *mut c_void, kind: c_int) -> *mut c_void;
    fn zmq_setsockopt(socket: *mut c_void, option: c_int, value: *const c_void, length: usize) -> c_int;
    fn zmq_bind(socket: *mut c_void, address: *const c_char) -> c_int;
    fn zmq_connect(socket: *mut c_void, address: *const c_char) -> c_int;
    fn zmq_join(socket: *mut c_void, group: *const c_char) -> c_int;
    fn zmq_msg_init(message: *mut Message) -> c_int;
    fn zmq_msg_init_size(message: *mut Message, size: usize) -> c_int;
    fn zmq_msg_data(message: *mut Message) -> *mut c_void;
    fn zmq_msg_size(message: *const Message) -> usize;
    fn zmq_msg_set_group(message: *mut Message, group: *const c_char) -> c_int;
    fn zmq_msg_group(message: *mut Message) -> *const c_char;
    fn zmq_msg_send(message: *mut Message, socket: *mut c_void, flags: c_int) -> c_int;
    fn zmq_msg_recv(message: *mut Message, socket: *mut c_void, flags: c_int) -> c_int;
    fn zmq_msg_close(message: *mut Message) -> c_int;
    fn zmq_errno() -> c_int;
    fn zmq_strerror(error: c_int) -> *const c_char;
}

fn check(result: c_int) -> Result<c_int> {
    if result >= 0 {
        return Ok(result);
    }
    // SAFETY: the text is a constant of the library.
    let text = unsafe { CStr::from_ptr(zmq_strerror(zmq_errno())) };
    bail!("libzmq: {}", text.to_string_lossy())
}

/// A context, which lives as long as the process.
#[derive(Clone, Copy)]
pub struct Context(*mut c_void);

impl Context {
    pub fn new() -> Self {
        // SAFETY: no arguments.
        Self(unsafe { zmq_ctx_new() })
    }

    /// Creates a RADIO that sends to an address.
    pub fn radio(self, address: &str) -> Result<Socket> {
        let (socket, address) = (self.socket(RADIO)?, CString::new(address)?);
        // SAFETY: the socket is open, the text ends with zero.
        check(unsafe { zmq_connect(socket.0, address.as_ptr()) })?;
        Ok(socket)
    }

    /// Creates a DISH that listens at an address and has joined a group.
    pub fn dish(self, address: &str, group: &str) -> Result<Socket> {
        let (socket, address, group) = (self.socket(DISH)?, CString::new(address)?, CString::new(group)?);
        // SAFETY: the socket is open, the texts end with zero.
        unsafe {
            check(zmq_bind(socket.0, address.as_ptr()))?;
            check(zmq_join(socket.0, group.as_ptr()))?;
        }
        Ok(socket)
    }

    fn socket(self, kind: c_int) -> Result<Socket> {
        // SAFETY: the context is open.
        let socket = Socket(unsafe { zmq_socket(self.0, kind) });
        if socket.0.is_null() {
            bail!("libzmq has no draft sockets");
        }
        for option in [SNDHWM, RCVHWM, LINGER] {
            // 0 means queues without a limit, and no wait for unsent messages at the end.
            let value: c_int = 0;
            // SAFETY: the options are of type int.
            check(unsafe { zmq_setsockopt(socket.0, option, (&raw const value).cast(), size_of::<c_int>()) })?;
        }
        Ok(socket)
    }
}

/// A RADIO or DISH; both may be used from any thread.
pub struct Socket(*mut c_void);

// SAFETY: draft sockets of these types are thread-safe (zmq_socket(3)).
unsafe impl Send for Socket {}

impl Socket {
    /// Sends a body to a group.
    pub fn send(&self, group: &str, body: &[u8]) -> Result<()> {
        let group = CString::new(group)?;
        let mut message = Message([0; 64]);
        // SAFETY: the message is initialised first; its data has the requested size; sending takes it over.
        unsafe {
            check(zmq_msg_init_size(&mut message, body.len()))?;
            std::ptr::copy_nonoverlapping(body.as_ptr(), zmq_msg_data(&mut message).cast(), body.len());
            check(zmq_msg_set_group(&mut message, group.as_ptr()))?;
            check(zmq_msg_send(&mut message, self.0, 0))?;
        }
        Ok(())
    }

    /// Waits for a message; returns its group and its body.
    pub fn receive(&self) -> Result<(String, Vec<u8>)> {
        let mut message = Message([0; 64]);
        // SAFETY: the message is initialised first, read while it is valid, and closed.
        unsafe {
            check(zmq_msg_init(&mut message))?;
            check(zmq_msg_recv(&mut message, self.0, 0))?;
            let size = zmq_msg_size(&message);
            let body = std::slice::from_raw_parts(zmq_msg_data(&mut message).cast(), size).to_vec();
            let group = CStr::from_ptr(zmq_msg_group(&mut message)).to_string_lossy().into_owned();
            check(zmq_msg_close(&mut message))?;
            Ok((group, body))
        }
    }
}
