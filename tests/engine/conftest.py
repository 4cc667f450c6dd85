import sys
from pathlib import Path

import cloudpickle

sys.path.insert(0, str(Path(__file__).parent))  # for toy_study
import toy_study

cloudpickle.register_pickle_by_value(toy_study)  # worker processes have no such path
