"""MuJoCo ships no types: here are those of the names that this package uses (`tests/base/test_stubs.py`).

Numbers that differ from model to model are arrays; an element of a spec takes any sequence for one.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

_Key = int | str | np.integer[Any]

class _Vector:
    def __get__(self, instance: Any, owner: Any = None) -> np.ndarray: ...
    def __set__(self, instance: Any, value: ArrayLike) -> None: ...

class MjOption:
    cone: int
    density: float
    disableflags: int
    enableflags: int
    gravity: np.ndarray
    impratio: float
    integrator: int
    iterations: int
    ls_iterations: int
    noslip_iterations: int
    solver: int
    timestep: float
    solver: int

class _View:
    id: int
    name: str

class _JointView(_View):
    qposadr: np.ndarray
    dofadr: np.ndarray

class _NumericView(_View):
    data: np.ndarray

class MjModel:
    actuator_actadr: np.ndarray
    actuator_armature: np.ndarray
    actuator_biasprm: np.ndarray
    actuator_ctrllimited: np.ndarray
    actuator_ctrlrange: np.ndarray
    actuator_damping: np.ndarray
    actuator_delay: np.ndarray
    actuator_forcelimited: np.ndarray
    actuator_forcerange: np.ndarray
    actuator_gainprm: np.ndarray
    actuator_gear: np.ndarray
    actuator_trnid: np.ndarray
    actuator_trntype: np.ndarray
    body_conaffinity: np.ndarray
    body_contype: np.ndarray
    body_geomadr: np.ndarray
    body_geomnum: np.ndarray
    body_inertia: np.ndarray
    body_invweight0: np.ndarray
    eq_type: np.ndarray
    eq_obj1id: np.ndarray
    eq_obj2id: np.ndarray
    eq_data: np.ndarray
    body_ipos: np.ndarray
    body_iquat: np.ndarray
    body_jntadr: np.ndarray
    body_jntnum: np.ndarray
    body_mass: np.ndarray
    body_parentid: np.ndarray
    body_rootid: np.ndarray
    body_weldid: np.ndarray
    body_pos: np.ndarray
    body_quat: np.ndarray
    body_subtreemass: np.ndarray
    body_treeid: np.ndarray
    dof_M0: np.ndarray
    dof_armature: np.ndarray
    dof_bodyid: np.ndarray
    dof_damping: np.ndarray
    dof_dampingpoly: np.ndarray
    dof_invweight0: np.ndarray
    dof_treeid: np.ndarray
    body_gravcomp: np.ndarray
    geom_aabb: np.ndarray
    geom_adhesion: np.ndarray
    geom_bodyid: np.ndarray
    cam_bodyid: np.ndarray
    cam_fovy: np.ndarray
    geom_conaffinity: np.ndarray
    geom_contype: np.ndarray
    geom_dataid: np.ndarray
    geom_fluid: np.ndarray
    geom_friction: np.ndarray
    geom_priority: np.ndarray
    geom_matid: np.ndarray
    geom_pos: np.ndarray
    geom_quat: np.ndarray
    geom_rbound: np.ndarray
    geom_group: np.ndarray
    geom_rgba: np.ndarray
    geom_sameframe: np.ndarray
    geom_size: np.ndarray
    geom_surfacevel: np.ndarray
    geom_type: np.ndarray
    hfield_adr: np.ndarray
    hfield_data: np.ndarray
    hfield_ncol: np.ndarray
    hfield_nrow: np.ndarray
    hfield_size: np.ndarray
    jnt_actfrclimited: np.ndarray
    jnt_actfrcrange: np.ndarray
    jnt_axis: np.ndarray
    jnt_bodyid: np.ndarray
    jnt_dofadr: np.ndarray
    jnt_limited: np.ndarray
    jnt_pos: np.ndarray
    jnt_qposadr: np.ndarray
    jnt_range: np.ndarray
    jnt_stiffness: np.ndarray
    jnt_type: np.ndarray
    mat_rgba: np.ndarray
    mesh_face: np.ndarray
    mesh_faceadr: np.ndarray
    mesh_facenum: np.ndarray
    mesh_vert: np.ndarray
    mesh_vertadr: np.ndarray
    mesh_vertnum: np.ndarray
    na: int
    nbody: int
    eq_data: np.ndarray
    neq: int
    nflex: int
    ngeom: int
    njnt: int
    nq: int
    ntendon: int
    nuserdata: int
    ntree: int
    nu: int
    nv: int
    opt: MjOption
    qpos0: np.ndarray
    qpos_spring: np.ndarray
    tendon_armature: np.ndarray
    @staticmethod
    def from_xml_string(xml: str, assets: Mapping[str, bytes] | None = None) -> MjModel: ...
    @staticmethod
    def from_xml_path(filename: str, assets: Mapping[str, bytes] | None = None) -> MjModel: ...
    def __copy__(self) -> MjModel: ...
    def actuator(self, key: _Key, /) -> _View: ...
    def body(self, key: _Key, /) -> _View: ...
    def equality(self, key: _Key, /) -> _View: ...
    def geom(self, key: _Key, /) -> _View: ...
    def joint(self, key: _Key, /) -> _JointView: ...
    def numeric(self, key: _Key, /) -> _NumericView: ...

class _MjContact:
    dist: float
    geom: np.ndarray

class _MjContactList:
    def __getitem__(self, index: int, /) -> _MjContact: ...
    def __len__(self) -> int: ...
    dist: np.ndarray
    geom: np.ndarray
    includemargin: np.ndarray
    pos: np.ndarray

class _MjWarningStatList:
    number: np.ndarray

class MjData:
    def __init__(self, model: MjModel) -> None: ...
    act: np.ndarray
    cam_xmat: np.ndarray
    cam_xpos: np.ndarray
    contact: _MjContactList
    ctrl: np.ndarray
    geom_xmat: np.ndarray
    geom_xpos: np.ndarray
    mocap_pos: np.ndarray
    mocap_quat: np.ndarray
    nefc: int
    qacc_warmstart: np.ndarray
    solver_niter: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    time: float
    warning: _MjWarningStatList
    xanchor: np.ndarray
    xaxis: np.ndarray
    xfrc_applied: np.ndarray
    ximat: np.ndarray
    xipos: np.ndarray
    xmat: np.ndarray
    xpos: np.ndarray
    model: MjModel
    ncon: int

class MjsCompiler:
    degree: bool

class MjSpec:
    actuators: list[MjsActuator]
    bodies: list[MjsBody]
    cameras: list[MjsCamera]
    equalities: list[MjsEquality]
    excludes: list[MjsExclude]
    geoms: list[MjsGeom]
    joints: list[MjsJoint]
    keys: list[Any]
    lights: list[MjsLight]
    materials: list[MjsMaterial]
    meshes: list[MjsMesh]
    memory: int
    modelname: str
    nuserdata: int
    option: MjOption
    pairs: list[Any]
    sensors: list[Any]
    sites: list[MjsSite]
    tendons: list[Any]
    worldbody: MjsBody
    compiler: MjsCompiler
    @staticmethod
    def from_string(
        xml: str,
        include: Mapping[str, bytes] | None = None,
        assets: dict[str, bytes] | None = None,
    ) -> MjSpec: ...
    @staticmethod
    def from_file(
        filename: str,
        include: Mapping[str, bytes] | None = None,
        assets: dict[str, bytes] | None = None,
    ) -> MjSpec: ...
    def body(self, name: str, /) -> MjsBody | None: ...
    def equality(self, name: str, /) -> MjsEquality | None: ...
    def geom(self, name: str, /) -> MjsGeom | None: ...
    def hfield(self, name: str, /) -> MjsHField | None: ...
    def joint(self, name: str, /) -> MjsJoint | None: ...
    def mesh(self, name: str, /) -> MjsMesh | None: ...
    def add_actuator(self, **fields: Any) -> MjsActuator: ...
    def add_equality(self, **fields: Any) -> MjsEquality: ...
    def add_exclude(self, **fields: Any) -> MjsExclude: ...
    def add_hfield(self, **fields: Any) -> MjsHField: ...
    def add_mesh(self, **fields: Any) -> MjsMesh: ...
    def add_numeric(self, **fields: Any) -> MjsNumeric: ...
    def compile(self) -> MjModel: ...
    def copy(self) -> MjSpec: ...
    def delete(self, element: Any, /) -> None: ...
    def recompile(self, model: MjModel, data: MjData) -> tuple[MjModel, MjData]: ...
    def to_xml(self) -> str: ...

class MjsBody:
    bodies: list[MjsBody]
    cameras: list[MjsCamera]
    explicitinertial: bool
    gravcomp: float
    inertia = _Vector()
    ipos = _Vector()
    iquat = _Vector()
    geoms: list[MjsGeom]
    id: int
    info: str
    joints: list[MjsJoint]
    lights: list[MjsLight]
    mass: float
    name: str
    parent: MjsBody
    pos = _Vector()
    quat = _Vector()
    sites: list[MjsSite]
    def first_body(self) -> MjsBody | None: ...
    def add_body(self, **fields: Any) -> MjsBody: ...
    def add_camera(self, **fields: Any) -> MjsCamera: ...
    def add_freejoint(self, **fields: Any) -> MjsJoint: ...
    def add_geom(self, **fields: Any) -> MjsGeom: ...
    def add_joint(self, **fields: Any) -> MjsJoint: ...
    def add_light(self, **fields: Any) -> MjsLight: ...
    def add_site(self, **fields: Any) -> MjsSite: ...

class MjsGeom:
    conaffinity: int
    condim: int
    contype: int
    density: float
    friction = _Vector()
    hfieldname: str
    id: int
    info: str
    mass: float
    meshname: str
    name: str
    parent: MjsBody
    pos = _Vector()
    priority: int
    quat = _Vector()
    rgba = _Vector()
    size = _Vector()
    solimp = _Vector()
    solref = _Vector()
    type: int

class MjsSite:
    id: int
    info: str
    meshname: str
    name: str
    parent: MjsBody
    pos = _Vector()
    quat = _Vector()
    rgba = _Vector()
    size = _Vector()
    type: int

class MjsJoint:
    actfrclimited: int
    actfrcrange = _Vector()
    armature: float
    axis = _Vector()
    damping = _Vector()
    frictionloss: float
    id: int
    info: str
    limited: int
    name: str
    parent: MjsBody
    pos = _Vector()
    range = _Vector()
    springref: float
    stiffness = _Vector()
    type: int

class MjsActuator:
    armature: float
    damping = _Vector()
    dyntype: int
    gainprm = _Vector()
    gaintype: int
    id: int
    info: str
    name: str
    target: str
    type: int

class MjsCamera:
    fovy: float
    id: int
    info: str
    mode: int
    name: str
    parent: MjsBody
    pos = _Vector()
    quat = _Vector()

class MjsMesh:
    file: str
    id: int
    inertia: mjtMeshInertia
    info: str
    name: str
    scale = _Vector()

class MjsHField:
    file: str
    id: int
    info: str
    name: str
    size = _Vector()

class MjsEquality:
    active: bool
    data = _Vector()
    id: int
    info: str
    name: str
    name1: str
    name2: str
    solimp = _Vector()
    solref = _Vector()
    type: int

class MjsNumeric:
    data: Any
    id: int
    info: str
    name: str
    size: int

class MjsMaterial:
    id: int
    info: str
    name: str
    rgba = _Vector()

class MjsExclude:
    bodyname1: str
    bodyname2: str
    id: int
    info: str
    name: str

class MjsLight:
    name: str

class _Enum(int):
    name: str
    value: int
    __members__: ClassVar[Mapping[str, Any]]

class mjtBias(_Enum):
    mjBIAS_NONE: ClassVar[mjtBias]
    mjBIAS_AFFINE: ClassVar[mjtBias]

class mjtCone(_Enum):
    mjCONE_ELLIPTIC: ClassVar[mjtCone]
    mjCONE_PYRAMIDAL: ClassVar[mjtCone]

class mjtEnableBit(_Enum):
    mjENBL_SLEEP: ClassVar[mjtEnableBit]

class mjtDisableBit(_Enum):
    mjDSBL_GRAVITY: ClassVar[mjtDisableBit]
    mjDSBL_MIDPHASE: ClassVar[mjtDisableBit]
    mjDSBL_AUTORESET: ClassVar[mjtDisableBit]
    mjDSBL_MULTICCD: ClassVar[mjtDisableBit]

class mjtMeshInertia(_Enum):
    mjMESH_INERTIA_CONVEX: ClassVar[mjtMeshInertia]

class mjtDyn(_Enum):
    mjDYN_NONE: ClassVar[mjtDyn]
    mjDYN_INTEGRATOR: ClassVar[mjtDyn]

class mjtEq(_Enum):
    mjEQ_JOINT: ClassVar[mjtEq]
    mjEQ_WELD: ClassVar[mjtEq]

class mjtObj(_Enum):
    mjOBJ_BODY: ClassVar[mjtObj]

class mjtGain(_Enum):
    mjGAIN_FIXED: ClassVar[mjtGain]
    mjGAIN_AFFINE: ClassVar[mjtGain]

class mjtGeom(_Enum):
    mjGEOM_PLANE: ClassVar[mjtGeom]
    mjGEOM_HFIELD: ClassVar[mjtGeom]
    mjGEOM_SPHERE: ClassVar[mjtGeom]
    mjGEOM_CAPSULE: ClassVar[mjtGeom]
    mjGEOM_ELLIPSOID: ClassVar[mjtGeom]
    mjGEOM_CYLINDER: ClassVar[mjtGeom]
    mjGEOM_BOX: ClassVar[mjtGeom]
    mjGEOM_MESH: ClassVar[mjtGeom]

class mjtIntegrator(_Enum):
    mjINT_EULER: ClassVar[mjtIntegrator]

class mjtJoint(_Enum):
    mjJNT_FREE: ClassVar[mjtJoint]
    mjJNT_SLIDE: ClassVar[mjtJoint]
    mjJNT_HINGE: ClassVar[mjtJoint]

class mjtLightType(_Enum):
    mjLIGHT_DIRECTIONAL: ClassVar[mjtLightType]

class mjtSolver(_Enum):
    mjSOL_CG: ClassVar[mjtSolver]
    mjSOL_NEWTON: ClassVar[mjtSolver]

class mjtState(_Enum):
    mjSTATE_QPOS: ClassVar[mjtState]
    mjSTATE_QVEL: ClassVar[mjtState]
    mjSTATE_ACT: ClassVar[mjtState]
    mjSTATE_WARMSTART: ClassVar[mjtState]
    mjSTATE_CTRL: ClassVar[mjtState]
    mjSTATE_XFRC_APPLIED: ClassVar[mjtState]
    mjNSTATE: ClassVar[mjtState]
    mjSTATE_FULLPHYSICS: ClassVar[mjtState]
    mjSTATE_INTEGRATION: ClassVar[mjtState]

class mjtCamLight(_Enum):
    mjCAMLIGHT_FIXED: ClassVar[mjtCamLight]

class mjtSensor(_Enum):
    mjSENS_ACCELEROMETER: ClassVar[mjtSensor]
    mjSENS_GYRO: ClassVar[mjtSensor]

class mjtTrn(_Enum):
    mjTRN_JOINT: ClassVar[mjtTrn]
    mjTRN_SITE: ClassVar[mjtTrn]

class mjtWarning(_Enum):
    mjWARN_CONTACTFULL: ClassVar[mjtWarning]
    mjWARN_CNSTRFULL: ClassVar[mjtWarning]

mjMAXVAL: float
mjNGROUP: int

def mj_collision(m: MjModel, d: MjData) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_getState(m: MjModel, d: MjData, state: np.ndarray, sig: int) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mj_multiRay(
    m: MjModel,
    d: MjData,
    pnt: np.ndarray,
    vec: np.ndarray,
    geomgroup: np.ndarray | None,
    flg_static: bool | int,
    bodyexclude: int,
    geomid: np.ndarray,
    dist: np.ndarray,
    normal: np.ndarray | None,
    nray: int,
    cutoff: float,
) -> None: ...
def mj_geomDistance(
    m: MjModel, d: MjData, geom1: int, geom2: int, distmax: float, fromto: np.ndarray | None
) -> float: ...
def mj_ray(
    m: MjModel,
    d: MjData,
    pnt: ArrayLike,
    vec: ArrayLike,
    geomgroup: ArrayLike | None,
    flg_static: int,
    bodyexclude: int,
    geomid: np.ndarray | None,
    normal: np.ndarray | None = None,
) -> float: ...
def mj_resetData(m: MjModel, d: MjData) -> None: ...
def mj_saveModel(m: MjModel, filename: str) -> None: ...
def mj_setConst(m: MjModel, d: MjData) -> None: ...
def mj_setState(m: MjModel, d: MjData, state: ArrayLike, sig: int) -> None: ...
def mj_stateSize(m: MjModel, sig: int) -> int: ...
def mj_step(m: MjModel, d: MjData, nstep: int = 1) -> None: ...
def mju_mat2Quat(quat: np.ndarray, mat: ArrayLike) -> None: ...
def mju_quat2Mat(res: np.ndarray, quat: ArrayLike) -> None: ...
def mju_rotVecQuat(res: np.ndarray, vec: ArrayLike, quat: ArrayLike) -> None: ...
def set_mju_user_warning(arg0: Callable[[str], None] | None) -> None: ...
