"""Files that others made, read within limits, and files of ours, written whole or not at all.

- foreign_files: opening the files that others made: regular ones, of a limited size
- foreign_meshes/: meshes of others (PLY, STL, OBJ, GLB), their structure checked before they are read
- images: image files: reading, conversion to 8-bit grey
- tables: tables and calibrations of a dataset, with errors that name file and line
- yaml_files, json_files: YAML and JSON, of limited size and depth
- array_files: archives of arrays (.npz), their headers compared with their sizes
- ply: binary PLY files; record_files: records as tables
- atomic: atomic writing of files
- output/: what commands write: places, what may be replaced there, folders that change places
"""
