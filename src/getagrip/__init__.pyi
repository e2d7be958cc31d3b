# The only list of public names: type checkers read it, and __init__.py loads each name from here when it is first used.
from .clip import Clip as Clip
from .clip import HandTrack as HandTrack
from .clip import Masks as Masks
from .clip import Segment as Segment
from .clip import Truth as Truth
from .clip import World as World
from .clip import read_clip as read_clip
from .clip import read_masks as read_masks
from .clip import write_clip as write_clip
from .errors import GetagripError as GetagripError
from .errors import InputError as InputError
from .errors import UsageError as UsageError
from .fitting.options import Options as Options
from .geometry.mesh import Mesh as Mesh
from .geometry.mesh_files import read_mesh as read_mesh
from .geometry.mesh_files import write_mesh as write_mesh
from .geometry.warp import Warp as Warp
from .metrics.evaluate import Evaluation as Evaluation
from .metrics.evaluate import evaluate as evaluate
from .provenance import Source as Source
from .reconstruct import reconstruct as reconstruct
from .report.pictures.result_picture import write_report as write_report
from .result import Axis as Axis
from .result import Candidates as Candidates
from .result import Reconstruction as Reconstruction
from .result import SegmentResult as SegmentResult
from .result import Status as Status
from .result import read_result as read_result
from .result import write_result as write_result
from .result.findings import Finding as Finding
from .synthetic.scene import synthesise as synthesise
from .synthetic.scene_options import SceneOptions as SceneOptions

__version__: str
