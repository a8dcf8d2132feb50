"""What Windows and macOS lack of what Python has on Linux, as data.

Source: the standard library's documentation, https://docs.python.org/3/library/, whose "Availability" lines say of each
module, function and constant which systems have it: "Availability: Unix" is not on Windows, "Availability: Linux" is on
neither. A test compares every list with a second source, the `sys.platform` conditions of typeshed's stubs. A word is a
name or a pattern of `fnmatch`, so that constants of one family need one word.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from fnmatch import fnmatchcase


@dataclass(frozen=True)
class Lack:
    """Names that a module has on Linux and not on another system."""

    module: str
    names: str
    """Names and patterns, between spaces."""

    until: tuple[int, int] = (4, 0)
    """From this version of Python on that system has them too."""

    def covers(self, name: str) -> bool:
        """Return whether the running version of Python lacks `name` there."""
        return sys.version_info < self.until and any(fnmatchcase(name, word) for word in self.names.split())


@dataclass(frozen=True)
class System:
    """What another system calls itself, and what it lacks."""

    name: str
    platform: str
    """Its `sys.platform`."""

    modules: frozenset[str]
    """Modules of the standard library that cannot be imported there."""

    lacks: tuple[Lack, ...]

    paths: tuple[str, ...]
    """Folders of Linux that are not there."""

    def hides(self, module: str, name: str) -> bool:
        """Return whether a module lacks a name there."""
        return any(lack.module == module and lack.covers(name) for lack in self.lacks)

    def lacks_file(self, path: str) -> bool:
        """Return whether a path leads into a folder that is not there; every system has a null device."""
        return path != os.devnull and any(path == each or path.startswith(f"{each}/") for each in self.paths)


LINUX_FOLDERS = ("/proc", "/sys", "/dev/shm", "/run")

_LINUX_SOCKETS = """
    AF_ALG AF_ASH AF_ATM* AF_AX25 AF_BRIDGE AF_CAN AF_ECONET AF_KEY AF_LLC AF_NETBEUI AF_NETLINK AF_NETROM AF_PACKET
    AF_PPPOX AF_QIPCRTR AF_RDS AF_ROSE AF_SECURITY AF_TIPC AF_VSOCK AF_WANPIPE AF_X25 ALG_* BTPROTO_[!R]* CAN_*
    ETH_P_ALL HCI_* IOCTL_VM_* IPPROTO_MPTCP IPPROTO_UDPLITE IPX_TYPE IP_BIND_ADDRESS_NO_PORT IP_TRANSPARENT J1939_*
    MSG_CMSG_CLOEXEC MSG_CONFIRM MSG_FASTOPEN MSG_MORE NETLINK_* NI_IDN PACKET_* PF_* RDS_* SCM_CREDENTIALS SCM_J1939_*
    SOCK_CLOEXEC SOCK_NONBLOCK SOL_A* SOL_CAN_* SOL_HCI SOL_IPX SOL_NETROM SOL_R* SOL_TIPC SO_BINDTOIFINDEX SO_DOMAIN
    SO_INCOMING_CPU SO_J1939_* SO_MARK SO_PASSCRED SO_PASSSEC SO_PEERCRED SO_PEERSEC SO_PRIORITY SO_PROTOCOL SO_VM_*
    TCP_CC_INFO TCP_CONGESTION TCP_CORK TCP_DEFER_ACCEPT TCP_FASTOPEN_* TCP_INFO TCP_INQ TCP_LINGER2 TCP_MD5SIG*
    TCP_QUEUE_SEQ TCP_QUICKACK TCP_REPAIR* TCP_SAVE* TCP_SYNCNT TCP_THIN_* TCP_TIMESTAMP TCP_TX_DELAY TCP_ULP
    TCP_USER_TIMEOUT TCP_WINDOW_CLAMP TCP_ZEROCOPY_RECEIVE TIPC_* UDPLITE_* VMADDR_* VM_*
"""

_LINUX_OS = """
    CLONE_* EFD_* GRND_* MFD_* O_DIRECT O_LARGEFILE O_NOATIME O_PATH O_RSYNC O_TMPFILE PIDFD_* POSIX_FADV_*
    POSIX_SPAWN_CLOSEFROM P_PIDFD RTLD_DEEPBIND RWF_* SCHED_BATCH SCHED_IDLE SCHED_RESET_ON_FORK SPLICE_* ST_NO[!S]*
    ST_RELATIME ST_[!NR]* TFD_* XATTR_* copy_file_range eventfd* fdatasync getrandom getresgid getresuid getxattr
    listxattr memfd_create pidfd_open pipe2 posix_fadvise posix_fallocate removexattr sched_getaffinity sched_getparam
    sched_getscheduler sched_rr_get_interval sched_setaffinity sched_setparam sched_setscheduler setns setresgid
    setresuid setxattr splice timerfd_* unshare
"""

_UNIX_OS = """
    CLD_* EX_OS* EX_[!O]* F_LOCK F_TEST F_TLOCK F_ULOCK NGROUPS_MAX O_ACCMODE O_ASYNC O_CLOEXEC O_DIRECTORY O_DSYNC
    O_FSYNC O_NDELAY O_NOCTTY O_NOFOLLOW O_NONBLOCK O_SYNC POSIX_SPAWN_* PRIO_* P_ALL P_PGID P_PID RTLD_* SCHED_*
    SEEK_DATA SEEK_HOLE ST_* W[A-Z]* chown chroot confstr* ctermid environb fchdir fchown fork forkpty fpathconf
    fstatvfs fwalk getegid getenvb geteuid getgid getgrouplist getgroups getloadavg getpgid getpgrp getpriority getsid
    getuid grantpt initgroups killpg lchown lockf login_tty major makedev minor mkfifo mknod nice openpty pathconf*
    posix_openpt posix_spawn* pread* ptsname pwrite* readv register_at_fork sched_* sendfile setegid seteuid setgid
    setgroups setpgid setpgrp setpriority setregid setreuid setsid setuid spawnlp spawnlpe spawnvp spawnvpe statvfs sync
    sysconf* tcgetpgrp tcsetpgrp ttyname uname unlockpt wait wait3 wait4 waitid waitid_result writev
"""

_UNIX_MODULES = """
    _dbm _gdbm _posixsubprocess crypt curses fcntl grp nis ossaudiodev posix pty pwd readline resource spwd syslog
    termios tty
"""

_UNIX_SIGNALS = """
    ITIMER_* ItimerError SIGALRM SIGBUS SIGCHLD SIGCLD SIGCONT SIGHUP SIGIO SIGIOT SIGKILL SIGPIPE SIGPOLL SIGPROF
    SIGPWR SIGQUIT SIGRT* SIGSTKFLT SIGSTOP SIGSYS SIGTRAP SIGTSTP SIGTT* SIGURG SIGUSR* SIGVTALRM SIGWINCH SIGXCPU
    SIGXFSZ SIG_BLOCK SIG_SETMASK SIG_UNBLOCK Sigmasks alarm getitimer pause pidfd_send_signal pthread_kill
    pthread_sigmask setitimer siginterrupt sigpending sigtimedwait sigwait* struct_siginfo
"""

_UNIX_SOCKETS = """
    AF_ROUTE AF_UNIX CMSG_* EAI_ADDRFAMILY EAI_OVERFLOW EAI_SYSTEM ETHERTYPE_* IPPROTO_GRE IPPROTO_IPIP IPPROTO_RSVP
    IPPROTO_TP IPV6_DSTOPTS IPV6_NEXTHOP IPV6_PATHMTU IPV6_RECV[DHP]* IPV6_RTHDRDSTOPTS IPV6_RTHDR_TYPE_0 IP_DEFAULT_*
    IP_MAX_MEMBERSHIPS IP_RECVOPTS IP_RECVRETOPTS IP_RETOPTS MSG_DONTWAIT MSG_EOR MSG_NOSIGNAL SCM_RIGHTS
    SO_BINDTODEVICE SO_REUSEPORT TCP_NOTSENT_LOWAT recv_fds send_fds sethostname
"""

_LINUX_SIGNALS = """
    SIGCLD SIGPOLL SIGPWR SIGRT* SIGSTKFLT pidfd_send_signal sigtimedwait sigwaitinfo struct_siginfo
"""

_LINUX_MMAP = """
    MADV_DODUMP MADV_DOFORK MADV_DONTDUMP MADV_DONTFORK MADV_HUGEPAGE MADV_HWPOISON MADV_MERGEABLE MADV_NOHUGEPAGE
    MADV_REMOVE MADV_UNMERGEABLE MAP_DENYWRITE MAP_EXECUTABLE MAP_POPULATE MAP_STACK
"""

_LINUX_RESOURCE = """
    RLIMIT_MSGQUEUE RLIMIT_NICE RLIMIT_OFILE RLIMIT_RT* RLIMIT_SIGPENDING RUSAGE_THREAD prlimit
"""

_LINUX_FCNTL = """
    DN_* FICLONE* F_*64 F_*OWN_EX F_*RW_HINT F_*SIG F_ADD_SEALS F_EXLCK F_GETPIPE_SZ F_GET_SEALS F_NOTIFY F_OWNER_*
    F_SEAL_* F_SETPIPE_SZ F_SHLCK I_* LOCK_MAND LOCK_READ LOCK_RW LOCK_WRITE RWH_*
"""

WINDOWS = System(
    name="windows",
    platform="win32",
    modules=frozenset(_UNIX_MODULES.split()),
    lacks=(
        Lack("os", _LINUX_OS),
        Lack("os", _UNIX_OS),
        Lack("os", "get_blocking set_blocking", until=(3, 12)),
        Lack("os", "fchmod", until=(3, 13)),
        Lack("signal", _UNIX_SIGNALS),
        Lack("socket", _LINUX_SOCKETS),
        Lack("socket", _UNIX_SOCKETS),
        Lack("select", "EPOLL* PIPE_BUF POLL* epoll poll"),
        Lack("selectors", "EpollSelector PollSelector"),
        Lack("time", "CLOCK_* clock_* pthread_getcpuclockid tzset"),
        Lack("mmap", "MADV_* MAP_* PROT_*"),
        Lack("sys", "abiflags getdlopenflags setdlopenflags"),
    ),
    paths=("/dev", *LINUX_FOLDERS),
)

MACOS = System(
    name="macos",
    platform="darwin",
    modules=frozenset({"ossaudiodev"}),
    lacks=(
        Lack("os", _LINUX_OS),
        Lack("os", "waitid waitid_result", until=(3, 13)),
        Lack("signal", _LINUX_SIGNALS),
        Lack("socket", _LINUX_SOCKETS),
        Lack("socket", "AF_BLUETOOTH AF_IRDA BDADDR_* BTPROTO_RFCOMM MSG_ERRQUEUE TCP_KEEPIDLE"),
        Lack("socket", "SO_BINDTODEVICE", until=(3, 13)),
        Lack("select", "EPOLL* POLLMSG POLLRDHUP epoll"),
        Lack("selectors", "EpollSelector"),
        Lack("time", "CLOCK_BOOTTIME CLOCK_TAI pthread_getcpuclockid"),
        Lack("mmap", _LINUX_MMAP),
        Lack("resource", _LINUX_RESOURCE),
        Lack("fcntl", _LINUX_FCNTL),
    ),
    paths=LINUX_FOLDERS,
)

SYSTEMS = {system.name: system for system in (WINDOWS, MACOS)}
