"""placeholder"""
def recover_leftovers(folder): pass
